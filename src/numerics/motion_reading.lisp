;;; Motions (motion.lisp): what can be read off one, and how it is shown and written.
;;;
;;; Entry points: $anmech_is_record, $anmech_motion_note, $anmech_motion_fact, $anmech_motion_rows,
;;; $anmech_show_without_record, $anmech_name, $anmech_write_table.

(in-package :anmech)
(needs "session/scope" "session/structures" "session/texts" "algebra/terms" "numerics/evaluation"
       "numerics/integration" "numerics/model" "numerics/motion")

;;; Facts and values

(maxima::defmfun maxima::$anmech_is_record (object)
  "anmech_is_record(object): whether it is the record of a motion."
  (motion-p object))

(maxima::defmfun maxima::$anmech_motion_note (motion name value)
  "anmech_motion_note(record, name, value): keep a fact about it."
  (push (cons name value) (motion-facts motion))
  value)

(maxima::defmfun maxima::$anmech_motion_fact (motion name)
  "anmech_motion_fact(record, name): what was noted, or one of its own numbers."
  (let* ((noted (assoc name (motion-facts motion))) (model (motion-model motion)))
    (if noted
        (cdr noted)
        (ecase name
          (maxima::$span (numbers-list (list (start-time motion) (motion-reached motion))))
          (maxima::$reached (motion-reached motion))
          (maxima::$states (cons '(maxima::mlist maxima::simp) (model-states model)))
          (maxima::$unknowns (cons '(maxima::mlist maxima::simp) (model-unknowns model)))
          (maxima::$names (cons '(maxima::mlist maxima::simp) (model-parameters model)))
          (maxima::$parameters (numbers-list (subseq (motion-start motion) (1+ (motion-dimension motion))
                                                      (length (plain-inputs model)))))
          (maxima::$error_estimate (or (motion-error-estimate motion) 'maxima::$unknown))
          (maxima::$status (or (motion-message motion) 'maxima::$complete))
          (maxima::$ended_by (let ((event (integration-ended-by (motion-integration motion))))
                               (and event (event-number event))))
          (maxima::$steps (integration-accepted (motion-integration motion)))
          (maxima::$rejected (integration-rejected (motion-integration motion)))
          (maxima::$evaluations (motion-evaluations motion))
          (maxima::$seconds (motion-seconds motion))
          (maxima::$compile_seconds (motion-compile-seconds motion))))))

(maxima::defmfun maxima::$anmech_motion_rows (motion expressions times)
  "anmech_motion_rows(motion, [expr, ...], [time, ...]): a list of values for each time.  The expressions may hold the
states, the time, the parameters and the unknowns, in jets; the times are doubles of its interval."
  (let* ((model (motion-model motion))
         (inner (holds-unknowns-p model (rest expressions)))
         (arrays (mapcar (lambda (time)
                           (let ((in (state-at motion time (make-array (length (motion-start motion))
                                                                       :element-type 'double-float))))
                             (if inner (with-unknowns model in) in)))
                         (rest times))))
    (cons '(maxima::mlist maxima::simp)
          (mapcar #'numbers-list
                  (evaluated (rest expressions)
                             (append (model-inputs model) (and inner (model-unknowns model)))
                             arrays)))))

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

(defun closing-parenthesis (text start)
  "The place in TEXT of the parenthesis that closes the first one from START on; nil if there is none."
  (let ((depth 0))
    (loop for place from start below (length text)
          do (case (char text place)
               (#\( (incf depth))
               (#\) (when (zerop (decf depth)) (return place)))))))

(defun typed-text (text)
  "TEXT, as Maxima shows an expression in one line, with derivatives as a user types them: diff(x,t) for 'diff(x,t,1)."
  (let* ((start (search "'diff(" text))
         (end (and start (closing-parenthesis text start))))
    (if (null end)
        text
        (let ((single (eql (search ",1" text :start2 (- end 2) :end2 end) (- end 2))))
          (concatenate 'string (subseq text 0 start)
                       (typed-text (subseq text (1+ start) (if single (- end 2) end)))
                       (typed-text (subseq text end)))))))

(maxima::defmfun maxima::$anmech_name (form)
  "anmech_name(expr): as a user types it, a string."
  (typed-text (plain-name form)))

(defun csv-field (text)
  "TEXT as a field of a table, in quotes where a comma would break it."
  (if (find #\, text) (format nil "\"~a\"" text) text))

(maxima::defmfun maxima::$anmech_write_table (file names rows)
  "anmech_write_table(file, [name, ...], [[number, ...], ...]): comma-separated values; the numbers read back exactly."
  (call-with-output-file file
    (lambda (stream)
      (let ((*read-default-float-format* 'double-float) (*package* (find-package :anmech)))
        (format stream "~{~a~^,~}~%" (mapcar #'csv-field (rest names)))
        (dolist (row (rest rows))
          (format stream "~{~s~^,~}~%" (rest row))))))
  'maxima::$done)
