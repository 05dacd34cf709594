;;; anmech: the builder of the manual.
;;;
;;; The examples of the manual are computed, not typed.  In the texinfo source an example is
;;;
;;;     @example
;;;     (%i1) coordinates([x])$
;;;     (%i2) energy(lagrange_system(m*diff(x,t)^2/2 - k*x^2/2, [x]));
;;;     (%o2) (k*x^2+m*('diff(x,t,1))^2)/2
;;;     @end example
;;;
;;; An input may go on over several lines, up to its ; or $.  What follows it, up to the next input, is its recorded
;;; output: printed text or the text of an error first, then the value.  The outputs are in one line's notation, broken
;;; at the margin; a first line "@c 2-D" asks for the two-dimensional picture, and then the value stands after it in a
;;; comment.  Every example begins in a session of its own: kill(all) and fpprintprec : 0 before it.  The same holds of
;;; README.md, where examples stand between lines ```maxima and ```.  README.zh.md is the same page in Chinese: what
;;; stands between lines ``` is copied to it.
;;;
;;; Entry point: anmech_build_manual("outputs") computes all outputs of the manual and of README.md anew;
;;; anmech_build_manual("index") writes the index that `? verb' reads, from the info file.  Maxima's way of printing
;;; differs from one version to the next: the committed outputs are those of 5.46, and the tests (rtest/manual.lisp)
;;; compare values.
;;;
;;; Copyright (C) 2026 the anmech authors.  Licence: GPL-2.0-or-later.

(in-package :cl-user)

(defpackage :anmech-manual
  (:use :common-lisp)
  (:import-from :anmech anmech::*module-directory* anmech::starts-with anmech::trimmed anmech::joined
                anmech::input-line-p anmech::input-text anmech::complete-input-p anmech::operator-p))

(in-package :anmech-manual)
(anmech::needs "session/batch" "session/examples" "session/scope")

(defparameter +margin+ 68 "Width of outputs, so that they fit on 80 columns where `describe' indents them.")

;;; Texts

(defmacro with-bytes-as-letters ((stream path &rest options) &body body)
  "BODY with a STREAM of letters, each of which is a byte of the file, as on GCL: what is not ASCII passes unchanged."
  `(with-open-file (,stream ,path ,@options #+(or sbcl ecl) :external-format #+(or sbcl ecl) :latin-1)
     ,@body))

(defun file-lines (path)
  (with-bytes-as-letters (stream path)
    (loop for line = (read-line stream nil) while line collect line)))

(defun write-lines (path lines)
  (with-bytes-as-letters (stream path :direction :output :if-exists :supersede)
    (format stream "~{~a~%~}" lines)))

(defun lines-of (text)
  "The lines of TEXT, without spaces at their ends and without empty ones at the end of all."
  (with-input-from-string (stream (string-right-trim '(#\Space #\Newline) text))
    (loop for line = (read-line stream nil) while line collect (string-right-trim " " line))))

(defun plain-text (line)
  "LINE of a texinfo example as the reader sees it; a comment as it is."
  (if (comment-line-p line)
      line
      (with-output-to-string (out)
        (loop with escaped = nil
              for letter across line
              do (if (and (char= letter #\@) (not escaped))
                     (setq escaped t)
                     (progn (write-char letter out) (setq escaped nil)))))))

(defstruct source-line "A line that is texinfo already." text)

(defun texinfo-text (line)
  "The reverse of plain-text."
  (cond ((source-line-p line) (source-line-text line))
        ((comment-line-p line) line)
        (t (with-output-to-string (out)
             (loop for letter across line
                   do (when (find letter "@{}") (write-char #\@ out))
                      (write-char letter out))))))

(defun comment-line-p (line) (starts-with "@c " line))

(defun wrapped (text width)
  "The words of TEXT in lines of at most WIDTH characters."
  (let ((lines '()) (line ""))
    (dolist (word (words-of text) (reverse (if (string= line "") lines (cons line lines))))
      (cond ((string= line "") (setq line word))
            ((> (+ (length line) 1 (length word)) width) (push line lines) (setq line word))
            (t (setq line (concatenate 'string line " " word)))))))

(defun words-of (text)
  (loop with start = 0
        for place = (position-if (lambda (letter) (member letter '(#\Space #\Newline))) text :start start)
        for word = (subseq text start place)
        unless (string= word "") collect word
        while place do (setq start (1+ place))))

;;; Examples in the source

(defstruct example-step
  "An input of an example, a list of LINES, and the lines RECORDED after it, all of them as the reader sees them;
PICTURE-P if these hold a picture, and the value in comments.  NUMBER is the line of the source, INDEX the input's own."
  lines recorded picture-p number index)

(defun map-examples (function file)
  "The lines of FILE, those inside every example that holds inputs replaced by what FUNCTION makes of its steps."
  (let* ((texinfo-p (search ".texi" file))
         (opening (if texinfo-p "@example" "```maxima"))
         (closing (if texinfo-p "@end example" "```"))
         (result '()) (inside '()) (begun nil))
    (loop for line in (file-lines file)
          for number from 1
          do (cond ((and begun (string/= line closing))
                    (push (if texinfo-p (plain-text line) line) inside))
                   (begun
                    (dolist (made (example-lines function (reverse inside) (1+ begun)))
                      (push (if texinfo-p (texinfo-text made) made) result))
                    (push line result)
                    (setq inside '() begun nil))
                   (t
                    (push line result)
                    (when (string= line opening) (setq begun number)))))
    (reverse result)))

(defun example-lines (function lines number)
  (if (find-if #'input-line-p lines)
      (funcall function (example-steps lines number))
      lines))

(defun picture-mark-p (line) (string= (trimmed line) "@c 2-D"))

(defun example-steps (lines number)
  "The steps of the example that consists of LINES, the first of them line NUMBER of the source."
  (let ((picture-p (and (find-if #'picture-mark-p lines) t)) (steps '()) (index 0))
    (loop while lines
          do (let ((line (pop lines)))
               (if (input-line-p line)
                   (let ((input (list line)))
                     (push (make-example-step :picture-p picture-p :number number :index (incf index)) steps)
                     (loop until (or (complete-input-p input) (null lines))
                           do (setq input (append input (list (pop lines)))) (incf number))
                     (setf (example-step-lines (first steps)) input))
                   (when steps
                     (setf (example-step-recorded (first steps))
                           (append (example-step-recorded (first steps)) (list line)))))
               (incf number)))
    (reverse steps)))

;;; What was recorded

(defun output-line-p (line) (starts-with "(%o" line))

(defun recorded-text (step)
  "What was printed, or the error: the lines before the value."
  (let ((lines (example-step-recorded step)))
    (joined (subseq lines 0 (position-if #'output-line-p lines)))))

(defun recorded-value-text (step)
  "The value in one line's notation without its label, or nil if none is recorded."
  (let* ((lines (example-step-recorded step))
         (value-lines (if (example-step-picture-p step)
                          (loop for line in lines when (comment-line-p line) collect (subseq line 3))
                          (member-if #'output-line-p lines))))
    (when value-lines (input-text value-lines))))

(defun noun-forms (form)
  "FORM with  'f(...)  read as the noun form of f."
  (cond ((atom form) form)
        ((operator-p form 'maxima::mquote)
         (let ((quoted (noun-forms (second form))))
           (if (and (consp quoted) (not (operator-p quoted 'maxima::mlist)))
               (cons (list (maxima::$nounify (caar quoted))) (rest quoted))
               quoted)))
        (t (cons (first form) (mapcar #'noun-forms (rest form))))))

(defun value-of (text)
  (maxima::simplifya (noun-forms (anmech::parsed (concatenate 'string text ";"))) nil))

;;; Running them

(defstruct outcome
  "VALUE of an input, TEXT that was printed on the way; ERROR-P if it ended in an error, whose message is then the end
of TEXT; SILENT-P if the input ended with $."
  value text error-p silent-p)

(defun start-example ()
  (setq maxima::$fpprintprec 0)
  (maxima::meval '((maxima::$kill) maxima::$all)))

(defun label (letter index)
  (intern (format nil "$%~a~d" letter index) :maxima))

(defun step-outcome (step)
  "Run the input of STEP as at a prompt."
  (multiple-value-bind (form silent-p) (anmech::parsed (input-text (example-step-lines step)))
    (let* ((maxima::$errormsg nil) (maxima::$ratprint nil) (answer nil)
           (text (with-output-to-string (*standard-output*)
                   (setq answer (maxima::meval* `((maxima::$errcatch) ,form)))))
           (error-p (maxima::$emptyp answer))
           (value (if error-p nil (second answer))))
      (unless error-p
        (set (label "O" (example-step-index step)) value)
        (setq maxima::$% value))
      (make-outcome :value value :error-p error-p :silent-p silent-p
                    :text (trimmed (if error-p (format nil "~a~%~a" text (last-error-text)) text))))))

(defun last-error-text ()
  (let ((maxima::$display2d nil) (maxima::$linel 10000))
    (trimmed (with-output-to-string (*standard-output*) (maxima::$errormsg)))))

(defun displayed (value index picture-p)
  "VALUE as Maxima prints it after its label, a list of lines."
  (let ((maxima::$display2d picture-p) (maxima::$linel +margin+) (maxima::*display-labels-p* t))
    (lines-of (with-output-to-string (*standard-output*)
                (maxima::displa `((maxima::mlabel) ,(label "O" index) ,value))))))

(defun output-lines (outcome index picture-p)
  "The lines that record OUTCOME."
  (append
   (if (outcome-error-p outcome)
       (wrapped (outcome-text outcome) +margin+)
       (lines-of (outcome-text outcome)))
   (unless (or (outcome-silent-p outcome) (outcome-error-p outcome))
     (displayed (outcome-value outcome) index picture-p))
   (when (and picture-p (not (outcome-silent-p outcome)) (not (outcome-error-p outcome)))
     (mapcar (lambda (line) (format nil "@c ~a" line)) (displayed (outcome-value outcome) index nil)))))

(defun example-anew (steps)
  "The inside of an example with its outputs computed anew, its inputs numbered from 1."
  (start-example)
  (append
   (when (example-step-picture-p (first steps)) (list "@c 2-D"))
   (loop for step in steps
         for index = (example-step-index step)
         for first-line = (first (example-step-lines step))
         collect (format nil "(%i~d)~a" index (subseq first-line (1+ (position #\) first-line))))
         append (rest (example-step-lines step))
         append (output-lines (step-outcome step) index (example-step-picture-p step)))))

(defmacro with-examples (&body body)
  "BODY where load(\"anmech\") means this very package, wherever it lies; afterwards numbers print as before."
  `(let ((maxima::$fpprintprec maxima::$fpprintprec)
         (maxima::$file_search_maxima
           (list* '(maxima::mlist) (concatenate 'string *module-directory* "###.mac")
                  (rest maxima::$file_search_maxima))))
     ,@body))

;;; The index

(defparameter +heading+ " -- Function: " "How the entry of a verb begins in an info file.")

(defun info-chunks (text)
  "A list of (kind name offset length node) for the nodes (kind :node) and definitions (:definition) of an info file.
A definition line right after another one gives a second form of call, and belongs to the same entry."
  (let ((marks '()) (node nil) (heading-p nil))
    (loop for start = 0 then (1+ end)
          for end = (position #\Newline text :start start)
          while end
          do (let ((line (subseq text start end)))
               (cond ((search ",  Node: " line)
                      (setq node (between ",  Node: " "," line))
                      (push (list :node node (1+ end) node) marks))
                     ((and (starts-with +heading+ line) (not heading-p))
                      (push (list :definition (between +heading+ " " line) start node) marks))
                     ((starts-with (string (code-char 31)) line) (push (list :end nil start nil) marks)))
               (setq heading-p (starts-with +heading+ line))))
    (setq marks (append (reverse marks) (list (list :end nil (length text) nil))))
    (loop for ((kind name offset node) . later) on marks
          unless (eq kind :end)
            collect (list kind name offset
                          (- (third (find-if (lambda (mark)
                                               (if (eq kind :node) (eq (first mark) :end) t))
                                             later))
                             offset)
                          node))))

(defun between (before after line)
  (let* ((start (+ (search before line) (length before))) (end (search after line :start2 start)))
    (subseq line start end)))

(defun index-lines (info)
  "The lines of the index file for the info file INFO, in the form of Maxima's own index files."
  (let ((chunks (info-chunks (joined (append (file-lines info) (list "")))))
        (file (file-namestring info)))
    (flet ((entries (wanted)
             (loop for (kind name offset length node) in chunks
                   when (and (eq kind wanted) (string/= name "Top"))
                     collect (format nil "(~s . (~s ~d ~d~@[ ~s~]))" name file offset length
                                     (and (eq kind :definition) node))
                   when (and (eq kind wanted) (string= name "Introduction to anmech"))      ; ? anmech
                     collect (format nil "(~s . (~s ~d ~d))" "anmech" file offset length))))
      (append
       (list ";;; Written by make doc from the info file: where `describe' finds the manual's entries and nodes."
             "(in-package :cl-info)"
             "(load-info-hashtables (maxima::maxima-load-pathname-directory) '(")
       (entries :definition) (list ") '(") (entries :node) (list "))")))))

;;; For the shell

(defun manual-file (name)
  (concatenate 'string *module-directory* name))

(defun manual-sources ()
  "anmech.texi and the files that it includes, in their order."
  (cons (manual-file "anmech.texi")
        (loop for line in (file-lines (manual-file "anmech.texi"))
              when (starts-with "@include " line) collect (manual-file (trimmed (subseq line 9))))))

(defun files-with-examples ()
  (append (manual-sources) (list (manual-file "../../README.md"))))

(defun block-edge-p (line) (starts-with "```" line))

(defun pieces (lines)
  "LINES as a list of lists: by turns what stands outside and, with these, between lines ```."
  (let ((pieces '()) (piece '()))
    (dolist (line lines (reverse (cons (reverse piece) pieces)))
      (cond ((not (block-edge-p line)) (push line piece))
            ((oddp (length pieces)) (push (reverse (cons line piece)) pieces) (setq piece '()))
            (t (push (reverse piece) pieces) (setq piece (list line)))))))

(defun blocks-of (pieces) (loop for (nil block) on pieces by #'cddr when block collect block))

(defun chinese-page () (manual-file "../../README.zh.md"))

(defun chinese-lines ()
  "The lines that README.zh.md should have: its own texts, and the blocks of README.md."
  (let ((blocks (blocks-of (pieces (file-lines (manual-file "../../README.md"))))))
    (append (loop for (text block) on (pieces (file-lines (chinese-page))) by #'cddr
                  append text
                  when block append (pop blocks))
            (loop for block in blocks append block))))

(defun build-step (name &rest files)
  (cond ((string= name "outputs")
         (with-examples
           (dolist (file (files-with-examples))
             (when (or (null files) (member (file-namestring file) files :test #'string=))
               (write-lines file (map-examples #'example-anew file)))))
         (write-lines (chinese-page) (chinese-lines)))
        ((string= name "index")
         (write-lines (manual-file "anmech-index.lisp") (index-lines (manual-file "anmech.info"))))
        (t (error "no step ~a" name))))

(defun carry-out (step action)
  "Maxima ends with the status of ACTION, the STEP of the manual's."
  (anmech::leave-maxima
   (handler-case (progn (funcall action) (format t "~&The manual's ~a: done~%" step) 0)
     (error (condition) (format t "~&The manual's ~a: ~a~%" step condition) 1))))

(maxima::defmfun maxima::$anmech_build_manual (step)
  "anmech_build_manual(step): the step \"outputs\" or \"index\" of make doc; does not return.  After \"outputs\" files
may be named, as in \"outputs README.md\": only theirs are computed."
  (carry-out step (lambda () (apply #'build-step (words-of step)))))
