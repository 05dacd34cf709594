;;; anmech: chunks, the files that hold what came of some of a sweep's points, one line for each.
;;;
;;;   anmech-chunk JOB NUMBER FIRST COUNT WIDTH MAKER      first line: the job's checksum, which points, cells of a row
;;;   POINT END ERROR STATUS CELL ...                      what came of a point; its rows, WIDTH cells each
;;;   end COUNT CHECKSUM                                   last line: of all lines before
;;;
;;; A cell is a double to the last bit, an integer, u for unknown, or e.. an expression; a status is complete, proved,
;;; unverified or a text.  A file that is not whole, or of another job, counts as none.
;;;
;;; A *result* is a list of Maxima's, [end, error, status, [row, ...]].  *Results* are what all points of a sweep have
;;; given: in memory or in a folder, where they are read as a stream.
;;;
;;; Entry points: the structure RESULTS, MAP-RESULTS; *PLAIN-STATUSES*; anmech_lists_across, anmech_write_chunk,
;;; anmech_results_in_memory, anmech_results_in_folder, anmech_missing_chunks, anmech_makers, anmech_chunk_file.

(in-package :anmech)
(needs "session/guard" "session/patience" "session/texts" "session/whole_files" "algebra/terms"
       "arithmetic/checksums" "sweeps/grids" "sweeps/stored_forms")

;;; Words

(defun cell-word (cell)
  (cond ((floatp cell) (if (and (= cell cell) (<= (abs cell) most-positive-double-float)) (double-word cell) "u"))
        ((integerp cell) (format nil "i~d" cell))
        ((eq cell 'maxima::$unknown) "u")
        (t (format nil "e~a" (escaped (stored-text cell))))))

(defun word-cell (word)
  (case (char word 0)
    (#\u 'maxima::$unknown)
    (#\i (whole-number word 1 (length word)))
    (#\e (stored-form (unescaped word 1)))
    (t (word-double word))))

(defparameter *plain-statuses* '(maxima::$complete maxima::$proved maxima::$unverified)
  "Of motions that came to their end.")

(defun status-word (status) (if (stringp status) (format nil "t~a" (escaped status)) (plain-name status)))

(defun word-status (word)
  (cond ((find word *plain-statuses* :key #'plain-name :test #'string=))
        ((char= (char word 0) #\t) (coerce (unescaped word 1) 'simple-string))
        (t (reject "~a is no status" (short-word word)))))

;;; Lines

(defun result-that-reads-back (result)
  "RESULT, or, where a file cannot hold what a map has given, what says so."
  (handler-case
      (dolist (row (rest (fifth result)) result)
        (dolist (cell (rest row))
          (unless (or (numberp cell) (symbolp cell)) (word-cell (cell-word cell)))))
    (unreadable (condition) (result-without-value result (unreadable-text condition)))
    (maxima::maxima-$error () (result-without-value result (text-of-error)))))

(defun result-without-value (result why)
  (maxima-list (list (second result) (third result) (format nil "a file cannot hold its value: ~a" why)
                     (maxima-list (list (maxima-list (list 'maxima::$unknown)))))))

(defun result-line (number result)
  (destructuring-bind (end error status rows) (rest (result-that-reads-back result))
    (format nil "~d ~a ~a ~a~{ ~a~}" number (cell-word end) (cell-word error) (status-word status)
            (loop for row in (rest rows) append (mapcar #'cell-word (rest row))))))

(defun words-of-result (line)
  (let ((words (split-words line)))
    (if (nthcdr 3 words) words (reject "a line is cut short"))))

(defun line-result (line number width)
  (destructuring-bind (place end error status &rest cells) (words-of-result line)
    (unless (eql (whole-number place 0 (length place)) number) (reject "point ~d is missing" number))
    (unless (if (zerop width) (null cells) (zerop (mod (length cells) width))) (reject "cells are missing"))
    (let ((cells (mapcar #'word-cell cells)))
      (maxima-list (list (word-cell end) (word-cell error) (word-status status)
                         (maxima-list (loop while cells
                                            collect (maxima-list (loop repeat width collect (pop cells))))))))))

;;; Files

(maxima::defmfun maxima::$anmech_lists_across (list &rest more)
  "anmech_lists_across([a, ...], [b, ...], ..): [[a, b, ..], ...].  Maxima's map simplifies what is simplified."
  (maxima-list (apply #'mapcar (lambda (&rest elements) (maxima-list elements)) (rest list) (mapcar #'rest more))))

(maxima::defmfun maxima::$anmech_chunk_file (folder number)
  "anmech_chunk_file(folder, number)"
  (format nil "~a/chunks/chunk_~6,'0d" folder number))

(defun chunk-head (job number first count width) (format nil "anmech-chunk ~a ~d ~d ~d ~d " job number first count
  width))

(maxima::defmfun maxima::$anmech_write_chunk (folder job number first width maker results)
  "anmech_write_chunk(folder, job, number, first, width, maker, [result, ...]): the file of this chunk."
  (let* ((lines (cons (concatenate 'string (chunk-head job number first (length (rest results)) width) (escaped maker))
                      (loop for result in (rest results)
                            for place from first
                            collect (result-line place result))))
         (checksum 0))
    (dolist (line lines) (setq checksum (extended-checksum line checksum)))   ; reduce  is quadratic on GCL
    (unless (write-whole-file (maxima::$anmech_chunk_file folder number)
                              (teller-of (append lines (list (format nil "end ~d ~a" (length (rest results))
                                                                   (checksum-text checksum))))))
      (complain "cannot write the chunk ~d to ~a; is the disk full, or read-only?" number folder)))
  'maxima::$done)

(defstruct (results (:print-function print-results))
  memory                     ; the list of all, or nil
  folder job chunk width     ; or where they lie: chunks of so many points
  count                      ; of points
  axes way seed)             ; the points

(defun print-results (object stream depth)
  (declare (ignore object depth))
  (write-string "..." stream))

(defun chunk-count (results) (ceiling (results-count results) (results-chunk results)))

(defun chunk-points (results number)
  "The first point of the chunk NUMBER, which counts from 1, and how many they are."
  (let ((first (* (1- number) (results-chunk results))))
    (values first (min (results-chunk results) (- (results-count results) first)))))

(defun call-with-chunk (results number function)
  "FUNCTION of the stream of a chunk behind its first line, and of that; nil where there is none of this job."
  (multiple-value-bind (first count) (chunk-points results number)
    (let ((head (chunk-head (results-job results) number first count (results-width results))))
      (with-open-file (stream (maxima::$anmech_chunk_file (results-folder results) number) :if-does-not-exist nil)
        (let ((line (and stream (read-line stream nil))))
          (and line (eql (mismatch head line) (length head)) (funcall function stream line)))))))

(defun chunk-there-p (results number)
  "By its ends; what lies between is checked when it is read."
  (handler-case
      (call-with-chunk results number
        (lambda (stream line)
          (declare (ignore line))
          (let ((length (file-length stream)))
            (file-position stream (max 0 (- length 60)))
            (let ((last (loop for line = (read-line stream nil) while line
                              when (eql 0 (search "end " line)) return line)))
              (and last (equal (second (split-words last))
                               (format nil "~d" (nth-value 1 (chunk-points results number)))))))))
    (error () nil)))

(defun line-of-chunk (stream)
  (handler-case (read-line stream)
    (end-of-file () (reject "it ends too early"))
    (error () (reject "it holds what is no text"))))

(defun map-chunk (function results number)
  "FUNCTION of the number and the result of each point; an error UNREADABLE if the chunk is not whole."
  (multiple-value-bind (first count) (chunk-points results number)
    (or (call-with-chunk results number
          (lambda (stream line)
            (let ((checksum (extended-checksum line)))
              (loop for place from first below (+ first count)
                    for line = (line-of-chunk stream)
                    do (setq checksum (extended-checksum line checksum))
                       (funcall function place (line-result line place (results-width results))))
              (unless (equal (line-of-chunk stream) (format nil "end ~d ~a" count (checksum-text checksum)))
                (reject "its checksum is wrong"))
              t)))
        (reject "it is not there"))))

(defun chunk-whole-p (results number)
  (handler-case (map-chunk (lambda (place result) (declare (ignore place result)) nil) results number)
    (error () nil)))

(maxima::defmfun maxima::$anmech_missing_chunks (results thorough)
  "anmech_missing_chunks(results, thorough): the numbers of those that are not there; THOROUGH: or damaged."
  (maxima-list (and (results-folder results)
                    (loop for number from 1 to (chunk-count results)
                          do (poll)
                          unless (if thorough (chunk-whole-p results number) (chunk-there-p results number))
                            collect number))))

(maxima::defmfun maxima::$anmech_makers (results)
  "anmech_makers(results): which Maximas have computed what is there."
  (let ((makers '()))
    (when (results-folder results)
      (loop for number from 1 to (chunk-count results)
            do (handler-case
                   (call-with-chunk results number
                     (lambda (stream line)
                       (declare (ignore stream))
                       (pushnew (unescaped (first (last (split-words line)))) makers :test #'string=)))
                 (error () nil))))
    (maxima-list (mapcar (lambda (maker) (coerce maker 'simple-string)) (sort makers #'string<)))))

(maxima::defmfun maxima::$anmech_results_in_memory (list axes way seed)
  "anmech_results_in_memory([result, ...], axes, way, seed)"
  (let ((count (length (rest list))))
    (make-results :memory list :count count :axes (quick-axes axes count) :way way :seed seed)))

(maxima::defmfun maxima::$anmech_results_in_folder (folder job chunk width count axes way seed)
  "anmech_results_in_folder(folder, job, chunk, width, count, axes, way, seed)"
  (make-results :folder folder :job job :chunk chunk :width width :count count
                :axes (quick-axes axes count) :way way :seed seed))

(defun map-results (function results &optional (from 0) (to (results-count results)))
  "FUNCTION of the number and the result of each point that is there, in order, from FROM up to and without TO."
  (flet ((within (place result) (when (and (>= place from) (< place to)) (funcall function place result))))
    (if (results-folder results)
        (loop for number from (1+ (floor from (results-chunk results)))
                to (min (chunk-count results) (ceiling to (results-chunk results)))
              do (poll)
                 (when (chunk-there-p results number)
                   (handler-case (map-chunk #'within results number)
                     (unreadable (condition)
                       (complain "the chunk ~d in ~a is damaged (~a); sweep_resume computes it again" number
                                 (results-folder results) (unreadable-text condition))))))
        (loop for result in (rest (results-memory results))
              for place from 0
              do (within place result)))))

(defun point-of (results number)
  (grid-point (results-axes results) (results-way results) (results-seed results) number))
