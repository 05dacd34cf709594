;;; Motions (motion.lisp): what can be read off one, and how it is shown and written.
;;;
;;; Entry points: VALUE-READER-REGISTERS, READING, ROWS-WITH-HOLES, FINITE-P, LONG-VALUES-AT-END, TIME-REACHED;
;;; $anmech_is_record, $anmech_motion_note, $anmech_motion_fact, $anmech_two_digits, $anmech_work_of_model;
;;; $anmech_sample_times, $anmech_reader, $anmech_read_rows, $anmech_read_values, $anmech_read_deviations,
;;; $anmech_largest, $anmech_times_along; $anmech_show_without_record, $anmech_name, $anmech_write_table.

(in-package :anmech)
(needs "session/prepared_code" "session/scope" "session/structures" "session/texts" "session/whole_files"
       "arithmetic/floats" "algebra/terms" "numerics/codegen" "numerics/dag" "numerics/doubles" "numerics/evaluation"
       "numerics/integration" "numerics/long_integration" "numerics/long_numbers" "numerics/model" "numerics/motion"
       "numerics/registers")

;;; Facts and values

(maxima::defmfun maxima::$anmech_is_record (object)
  "anmech_is_record(object): whether it is the record of a motion."
  (motion-p object))

(maxima::defmfun maxima::$anmech_motion_note (motion name value)
  "anmech_motion_note(record, name, value): keep a fact about it."
  (push (cons name value) (motion-facts motion))
  value)

(defun time-reached (motion)
  "A number of Maxima."
  (let ((record (motion-long motion)))
    (if record
        (bigfloat-near (long-record-reached record) (long-record-digits record))
        (motion-reached motion))))

(maxima::defmfun maxima::$anmech_motion_fact (motion name)
  "anmech_motion_fact(record, name): what was noted, or one of its own numbers."
  (let* ((noted (assoc name (motion-facts motion))) (model (motion-model motion)))
    (if noted
        (cdr noted)
        (ecase name
          (maxima::$reached (time-reached motion))
          (maxima::$states (cons '(maxima::mlist maxima::simp) (model-states model)))
          (maxima::$unknowns (cons '(maxima::mlist maxima::simp) (model-unknowns model)))
          (maxima::$names (cons '(maxima::mlist maxima::simp) (model-parameters model)))
          (maxima::$parameters (if (motion-long motion)
                                   (maxima-list (long-parameters (motion-long motion) (1+ (motion-dimension motion))))
                                   (numbers-list (subseq (motion-start motion) (1+ (motion-dimension motion))
                                                         (length (plain-inputs model))))))
          (maxima::$digits (if (motion-long motion) (long-record-digits (motion-long motion)) 16))
          (maxima::$error_estimate (or (motion-error-estimate motion) 'maxima::$unknown))
          (maxima::$status (status-of-motion motion))
          (maxima::$stiffness (let ((stiffness (integration-stiffness (motion-integration motion))))
                                (and stiffness (numbers-list (list (car stiffness) (cdr stiffness))))))
          (maxima::$ended_by (let ((event (integration-ended-by (motion-integration motion))))
                               (and event (event-number event))))
          (maxima::$steps (integration-accepted (motion-integration motion)))
          (maxima::$rejected (integration-rejected (motion-integration motion)))
          (maxima::$evaluations (motion-evaluations motion))
          (maxima::$seconds (motion-seconds motion))
          (maxima::$compile_seconds (motion-compile-seconds motion))))))

(maxima::defmfun maxima::$anmech_two_digits (number)
  "anmech_two_digits(number): a float rounded up to two digits, as estimates of errors are told."
  (two-digits number))

(maxima::defmfun maxima::$anmech_work_of_model (given)
  "anmech_work_of_model(record or model): about how many operations the rates take."
  (model-work (if (motion-p given) (motion-model given) given)))

;;; Values along a motion.  What reads some expressions is made once for a model: a user asks the same of many motions,
;;; or of one motion at many times.

(defstruct (value-reader (:print-function print-dots))
  (registers nil :type registers)
  expressions inputs                         ; what they were made of
  (long nil)                                 ; LONG-READER, as soon as somebody has asked for it
  inner)                                     ; whether they hold unknowns, which stand behind the inputs of the model

(defparameter *most-readers* 16 "So many of a model are kept.")

(defun reader-of-values (model expressions)
  "EXPRESSIONS may hold the states, the time, the parameters and the unknowns, in jets."
  (let* ((inner (holds-unknowns-p model expressions))
         (inputs (append (model-inputs model) (and inner (model-unknowns model)))))
    (make-value-reader :registers (expressions-registers expressions inputs) :expressions expressions :inputs inputs
                       :inner inner)))

(maxima::defmspec maxima::$anmech_reader (form)
  "anmech_reader(record or model, key, [expr, ...]): what reads the expressions, which are evaluated once for a model
and key."
  (evaluate (prepared form)))

(define-preparation maxima::$anmech_reader (form)
  (destructuring-bind (given key expressions) (mapcar #'prepared (rest form))
    (lambda ()
      (let ((given (evaluate given)))
        (reader-for (if (motion-p given) (motion-model given) given) (evaluate key) expressions)))))

(defun reader-for (model key expressions)
  (or (cdr (assoc key (model-readers model) :test #'equal))
      (let ((reader (reader-of-values model (rest (evaluate expressions)))))
        (setf (model-readers model)
              (cons (cons key reader)
                    (subseq (model-readers model) 0 (min (length (model-readers model)) (1- *most-readers*)))))
        reader)))

(defun reading (motion reader)
  "A function that brings the numbers of the registers of READER to a time; it is fastest from one time to a later one."
  (let* ((registers (value-reader-registers reader)) (numbers (registers-numbers registers))
         (model (motion-model motion)) (solver (and (value-reader-inner reader) (model-solver model)))
         (unknowns (zeros (length (model-unknowns model)))) (size (length (motion-start motion)))
         (n (motion-dimension motion)) (integration (motion-integration motion))
         (sides (and solver (sides-of motion))) (times (integration-times integration)) (place 0))
    (declare (type (simple-array double-float (*)) numbers unknowns times) (fixnum place n size))
    (replace numbers (the double-array (motion-start motion)))
    (lambda (time)
      (declare (double-float time))
      (cond ((= time (integration-time integration))
             (replace numbers (the double-array (integration-final integration))))
            (t (setq place (if (<= (aref times 0) (aref times place) time)
                               (step-place-from times place time)
                               (step-place times time)))
               (value-in-step integration place time numbers)))
      (setf (aref numbers n) time)
      (when sides (funcall (the function sides) numbers))
      (when solver
        (funcall (the function solver) numbers unknowns)
        (replace numbers unknowns :start1 size))
      (run-registers registers)
      nil)))

(defun read-rows (motion reader times row)
  "A list of what the function ROW gives at each of TIMES: it is called without arguments."
  (declare (type function row))
  (with-value-errors
    (lambda ()
      (let ((read (reading motion reader)))
        (declare (type function read))
        (loop for time in times
              do (funcall read time)
              collect (funcall row))))))

(maxima::defmfun maxima::$anmech_read_rows (record reader times)
  "anmech_read_rows(record, reader, [time, ...]): a list of values for each time, a double within the motion."
  (maxima-list
   (if (motion-long record)
       (loop for row in (long-rows record reader (rest times)) collect (maxima-list (bigfloats-of record row)))
       (let ((registers (value-reader-registers reader)))
         (read-rows record reader (rest times) (lambda () (maxima-list (result-list registers))))))))

(maxima::defmfun maxima::$anmech_read_values (record reader times)
  "anmech_read_values(record, reader, [time, ...]): for each time the value of the only expression."
  (maxima-list
   (if (motion-long record)
       (bigfloats-of record (mapcar #'first (long-rows record reader (rest times))))
       (let* ((registers (value-reader-registers reader)) (numbers (registers-numbers registers))
              (place (aref (registers-results registers) 0)))
         (read-rows record reader (rest times) (lambda () (aref numbers place)))))))

;;; Values of many digits

(defun long-reader (reader bits)
  "A function (inputs) of vectors of rational numbers."
  (let ((known (value-reader-long reader)))
    (if (eql bits (car known))
        (cdr known)
        (let ((program (with-compilation-errors
                         (lambda ()
                           (expressions-program (value-reader-expressions reader) (value-reader-inputs reader)
                                                :round-constants nil)))))
          (cdr (setf (value-reader-long reader) (cons bits (program-function program (long-numbers bits)))))))))

(defun long-row-at (motion reader)
  "A function of a time, a number of Maxima: the list of values there, rational numbers."
  (let* ((record (motion-long motion)) (integration (long-record-integration record)) (n (motion-dimension motion))
         (bits (long-field-bits (long-integration-field integration))) (model (motion-model motion))
         (function (long-reader reader bits))
         (parameters (subseq (long-record-inputs record) (1+ n))))
    (declare (type function function))
    (lambda (given)
      (let* ((time (time-within integration (exact-value given (+ 20 (long-record-digits record)))))
             (inputs (concatenate 'vector (long-states-at integration time) (list time) parameters)))
        (funcall function (if (value-reader-inner reader)
                              (concatenate 'vector inputs (long-unknowns model inputs bits))
                              inputs))))))

(defun long-rows (motion reader times)
  "For each of TIMES, numbers of Maxima, a list of rational numbers."
  (with-value-errors (lambda () (mapcar (long-row-at motion reader) times))))

(defun long-values-at-end (motion reader)
  "Bigfloats."
  (bigfloats-of motion (funcall (the function (long-row-at motion reader))
                                (from-rational (long-record-reached (motion-long motion))))))

(defun bigfloats-of (motion numbers)
  (let ((digits (+ *more-digits* (long-record-digits (motion-long motion)))))
    (mapcar (lambda (number) (bigfloat-near number digits)) numbers)))

(defun long-parameters (record first)
  (map 'list (lambda (number) (bigfloat-near number (long-record-digits record)))
       (subseq (long-record-inputs record) first)))

(maxima::defmfun maxima::$anmech_sample_times (motion samples)
  "anmech_sample_times(record, n or [time, ...]): so many equidistant times of the motion, or those of them within it;
one that ends early has fewer of the samples that were listed."
  (let* ((long (motion-long motion))
         (start (if long (elt (long-record-inputs long) (motion-dimension motion)) (start-time motion)))
         (end (if long (long-record-reached long) (motion-reached motion))))
    (cond ((consp samples) (maxima::$anmech_those_within samples start end (if long :given t)))
          (long (maxima-list (bigfloats-of motion (equal-parts start end samples))))
          (t (maxima-list (equal-parts start end samples))))))

(maxima::defmfun maxima::$anmech_largest (rows)
  "anmech_largest([[number, ...], ...]): the largest of each column; unknown if one of it is."
  (flet ((larger (first second)
           (if (and (numberp first) (numberp second)) (max first second) 'maxima::$unknown)))
    (maxima-list (reduce (lambda (largest row) (mapcar #'larger largest row)) (mapcar #'rest (rest rows))))))

(maxima::defmfun maxima::$anmech_times_along (record times interval)
  "anmech_times_along(record, [time, ...], interval): as doubles.  Rounding may carry a time that was meant to be an end
just beyond it."
  (let* ((start (start-time record)) (end (motion-reached record))
         (low (min start end)) (high (max start end)))
    (flet ((within (given)
             (let ((time (if (floatp given) given (maxima::$anmech_double given))))
               (flet ((near-p (border)                    ; late, a few units in the last place may be a long time
                        (<= (abs (- time border)) (min (* 1d-14 (abs border))
                                                       (max (* 5d-16 (abs border)) (* 1d-9 (- high low)))))))
                 (cond ((null time) (complain "expected a time, found ~a" (one-line given)))
                       ((<= low time high) (if (motion-long record) given time))
                       ((near-p end) end)
                       ((near-p start) start)
                       (t (complain "the time ~a is outside of the motion's interval ~a" (one-line given)
                                    (one-line interval))))))))
      (maxima-list (mapcar #'within (rest times))))))

(maxima::defmfun maxima::$anmech_read_deviations (record reader times zero)
  "anmech_read_deviations(record, reader, times, [true or false, ...]): of expressions, of which the reader also reads
the sizes, how far they are from their first values, or from zero, relative to the largest size: a list for each time.
Where an expression has no value, or one that is too large for a double: unknown."
  (let* ((rows (rows-with-holes record reader (rest times))) (n (length (rest zero)))
         (targets (mapcar (lambda (value zero) (if zero 0 value)) (or (first rows) (rest zero)) (rest zero)))
         (largest (make-list n :initial-element 0d0)))
    (dolist (row rows)
      (when row
        (setq largest (mapcar (lambda (largest size) (if (finite-p size) (max largest size) largest))
                              largest (nthcdr n row)))))
    (flet ((deviation (value target size)
             (cond ((not (and (finite-p value) (finite-p target) (finite-p size))) 'maxima::$unknown)
                   ((zerop size) 0d0)
                   (t (let ((part (/ (abs (- value target)) size))) (if (floatp part) part (to-double part)))))))
      (maxima-list
       (mapcar (lambda (row)
                 (maxima-list (if row
                                  (mapcar #'deviation row targets largest)
                                  (make-list n :initial-element 'maxima::$unknown))))
               rows)))))

(defun rows-with-holes (motion reader times)
  "The values at each of TIMES, nil where one of them is none."
  (let ((row (if (motion-long motion) (long-row-at motion reader) (double-row-at motion reader))))
    (declare (type function row))
    (loop for time in times
          collect (handler-case (funcall row time)
                    ((or domain-violation arithmetic-error) () nil)))))

(defun double-row-at (motion reader)
  (let ((read (reading motion reader)) (registers (value-reader-registers reader)))
    (declare (type function read))
    (lambda (time)
      (funcall read time)
      (result-list registers))))

(defun finite-p (number)
  (if (typep number 'double-float)
      (<= (abs number) most-positive-double-float)         ; not so of NaN
      (numberp number)))

;;; What is shown of a motion: all but the record

(defun display-motion (form result) (display-structure (butlast form) result))
(defun tex-motion (form left right) (tex-structure (butlast form) left right))
(defun wxxml-motion (form left right) (wxxml-structure (butlast form) left right))
(defun grind-motion (form left right) (maxima::msize-function (butlast form) left right nil))

(maxima::defmfun maxima::$anmech_show_without_record (head)
  "anmech_show_without_record(head): structures with this head are shown without their last argument."
  (setf (get head 'maxima::dimension) 'display-motion
        (get head 'maxima::tex) 'tex-motion
        (get head 'maxima::wxxml) 'wxxml-motion
        (get head 'maxima::grind) 'grind-motion)
  'maxima::$done)

;;; What save cannot write: a record holds compiled code

(defparameter *names-of-labels*
  '(maxima::$all maxima::$labels maxima::$inlabels maxima::$outlabels maxima::$linelabels)
  "What stands for labels in the arguments of save; so does a list of numbers.")

(defun record-in (form)
  (if (consp form)
      (or (record-in (car form)) (record-in (cdr form)))
      (or (motion-p form) (model-p form))))

(defun names-to-save (arguments)
  "The variables that save(file, ARGUMENTS) may write."
  (let ((names (symbols-in (cons 'list arguments))))
    (append names
            (when (intersection names '(maxima::$all maxima::$values)) (rest maxima::$values))
            (when (or (intersection names *names-of-labels*)
                      (some (lambda (argument) (operator-p argument 'maxima::mlist)) arguments))
              (rest maxima::$labels)))))

(defun check-saved (arguments)
  (dolist (name (names-to-save arguments))
    (when (and (boundp name) (record-in (symbol-value name)))
      (maxima::merror "save: ~A holds a motion, whose compiled code no file can hold; ~A"
                      (plain-name name)
                      "motion_save writes its values, and what it was made of can be saved"))))

(let ((save (get 'maxima::$save 'maxima::mfexpr*)))
  (setf (get 'maxima::$save 'maxima::mfexpr*)
        (lambda (form)
          (check-saved (cddr form))
          (funcall save form))))

;;; Texts and files

(defun csv-field (text)
  "TEXT as a field of a table, in quotes where a comma would break it."
  (if (find #\, text) (format nil "\"~a\"" text) text))

(defun decimal-text (number digits)
  "The rational NUMBER with so many decimal digits, as 1.25e-3."
  (if (zerop number)
      "0.0"
      (let ((exponent (floor (binary-logarithm number) (log 10d0 2d0))))
        (flet ((scaled () (round (* (abs number) (expt 10 (- digits 1 exponent))))))
          (when (>= (scaled) (expt 10 digits)) (incf exponent))
          (when (< (scaled) (expt 10 (1- digits))) (decf exponent))
          (let ((text (format nil "~d" (scaled))))
            (format nil "~:[~;-~]~a.~ae~d" (minusp number) (subseq text 0 1) (subseq text 1) exponent))))))

(defun csv-number (number)
  (if (operator-p number 'maxima::bigfloat)
      (decimal-text (exact-value number) (1+ (digits-of-bits (third (first number)))))
      (format nil "~s" number)))

(maxima::defmfun maxima::$anmech_write_table (file names rows)
  "anmech_write_table(file, [name, ...], [[number, ...], ...]): comma-separated values; the numbers read back exactly."
  (write-file file
    (lambda (tell)
      (let ((*read-default-float-format* 'double-float) (*package* (find-package :anmech)))
        (flet ((tell-fields (texts) (funcall tell (format nil "~{~a~^,~}" texts))))
          (tell-fields (mapcar #'csv-field (rest names)))
          (dolist (row (rest rows)) (tell-fields (mapcar #'csv-number (rest row))))))))
  'maxima::$done)
